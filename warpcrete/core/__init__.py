"""What any method needs: errors, units, devices, parameters, launching, the run loop, files, provenance."""
