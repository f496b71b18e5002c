"""A concrete described as a mix: what a file says of it, and what follows for elements and flows."""
