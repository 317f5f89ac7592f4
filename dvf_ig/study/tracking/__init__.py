"""Stylus held to the beating surface by a guidance fixture alone."""
