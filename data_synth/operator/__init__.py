"""What the operator's hands do: probe path, tool path, contact with the heart; a hand that answers force."""
