"""A photograph of a person, warped and relit, with nothing learnt."""
