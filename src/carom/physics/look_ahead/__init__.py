"""The look ahead: a run's step, found by running its scene with longer steps first."""
