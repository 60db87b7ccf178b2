"""The REST door: durable jobs over HTTP, run by the same engine as the command line."""
