"""Clothes, hats, glasses, jewellery."""
