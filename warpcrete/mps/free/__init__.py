"""Standard tests of fresh concrete with a free surface, as flows on a grid."""
