"""Self-test: limiting cases of the product, each against an answer known from elsewhere."""
