"""What scenes and sweeps may ask for over REST, with their catalogues and uploads."""
