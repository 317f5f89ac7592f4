"""LC2's sums: on tracked slices, on parts of them and on blocks of a 3-D image, with their gradients."""
