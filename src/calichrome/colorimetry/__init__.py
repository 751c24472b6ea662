"""Colour of the standard observer: encodings, adaptation, differences."""
