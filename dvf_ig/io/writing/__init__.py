"""Write files as a whole or not at all, and never over a user's files."""
