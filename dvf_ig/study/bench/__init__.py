"""`dvf-ig bench`: time and error of the fixture and of other ways to the same distance."""
