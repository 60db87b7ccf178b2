"""The sphere: directions, nested HEALPix pixels and what they number, regions."""
