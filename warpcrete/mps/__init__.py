"""Concrete as a Bingham fluid with a slip layer, solved by implicit moving particles (MPS) or on a grid."""
