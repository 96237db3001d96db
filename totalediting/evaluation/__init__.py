"""How good edits are on held-out people: tables against the truth, of a run or of other systems."""
