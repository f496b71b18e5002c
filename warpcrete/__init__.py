"""warpcrete: particle simulation of fresh concrete being pumped, on GPU or CPU."""
