"""Registration of 3-D images of an organ that does not beat, judged by its consistency with itself."""
