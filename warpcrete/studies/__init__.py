"""Many runs together: parameter studies, and what is made of unit pressures."""
