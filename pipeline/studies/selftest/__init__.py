"""Self-test: hard ends of the product, each against an answer known from elsewhere."""
