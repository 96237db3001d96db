"""The posed figure in light: environments one by one or all at once, and what denoises them."""
