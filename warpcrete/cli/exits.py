"""Exit codes of the `warpcrete` command for failed checks and for interrupted runs."""

CHECK_FAILED = 3
"""Exit code of a finished run that failed one of the scene's checks."""
INTERRUPTED = 130
"""Exit code of a run that the user interrupted."""
