"""Physics as pure functions on arrays; rooms do not know each other."""
