"""How many phases a dynamic fixture needs."""
