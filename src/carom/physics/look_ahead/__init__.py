"""The look-ahead: finds a run's step by first running the scene with longer steps."""
