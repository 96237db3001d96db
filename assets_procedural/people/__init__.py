"""Who a person is, and how people are drawn from a population."""
