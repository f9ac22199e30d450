"""Monte Carlo studies: simulated recordings, every filter on the same data, scores."""
