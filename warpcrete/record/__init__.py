"""Recorders and readers of runs: run folders, Rerun recordings, USD scenes, ParaView files, pictures and notebooks."""
