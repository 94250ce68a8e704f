"""What a run says about itself: energy, momentum, extremes, activity, fingerprints, and where the time goes."""
