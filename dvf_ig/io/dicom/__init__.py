"""DICOM: a folder with the images of a short-axis cine stack."""
