"""One file a resource: jobs, results, catalogues, schema, health, pages."""
