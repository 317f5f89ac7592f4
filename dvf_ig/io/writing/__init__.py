"""Files that are written whole or not at all, and never over a file of somebody else."""
