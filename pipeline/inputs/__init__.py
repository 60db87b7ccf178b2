"""Everything that is read: stars, ephemerides, curves, images, meshes."""
