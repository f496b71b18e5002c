"""Parameter studies, calibrations, speed-accuracy trade-offs, pipelines and whole pump lines."""
