"""The command line's `nightglass report ...` and `selftest`: studies of the product itself."""
