"""What sensor and optics are made from: images, tables, libraries."""
