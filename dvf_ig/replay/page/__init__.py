"""A replay and a registration handed to their pages: planes, checks and findings in words and numbers."""
