"""What targets are made from: orbits, ephemerides, populations, meshes."""
