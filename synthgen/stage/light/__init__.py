"""The posed figure in light, environment by environment, and what takes the noise out."""
