"""Content of the pages of replays and registrations: planes, checks and findings in words and numbers."""
