"""Watch over a pose in use, on recordings in which nothing happens or the heart is displaced."""
