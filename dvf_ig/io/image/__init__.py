"""Images on regular grids: NIfTI, NRRD, MetaImage, their labels, seeds and times."""
