"""Where runs go: run folders, recordings, USD scenes, pictures, notebooks."""
