"""Points touched on the heart's surface against the model's: a start of a registration and a check of one."""
