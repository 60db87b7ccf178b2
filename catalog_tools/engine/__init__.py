"""Where work runs: schedulers, clusters, threads, and how processes hold memory."""
