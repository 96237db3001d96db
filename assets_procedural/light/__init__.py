"""HDR environments: the pool of a job, skies, studios, backdrops."""
