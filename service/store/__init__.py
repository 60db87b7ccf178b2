"""The database: its tables, leases, and the files that stored scenes name."""
