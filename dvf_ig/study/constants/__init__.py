"""Every constant of registration: what it is, which hearts it was chosen on, and what ± 30 % of it do."""
