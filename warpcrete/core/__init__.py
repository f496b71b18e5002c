"""Code that all simulation methods share: errors, units, devices, parameters, kernel launches and the run loop."""
