"""`dvf-ig bench`: time and error of the fixture beside other ways to the same distance."""
