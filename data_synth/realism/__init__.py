"""How real the synthetic world is, measured."""
