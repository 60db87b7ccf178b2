"""Jobs: the durable record, submissions, changes, how they look to clients."""
