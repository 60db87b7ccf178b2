"""The command line's `nightglass catalog ...`: star catalogues."""
