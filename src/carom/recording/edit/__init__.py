"""Files made of other files: clips, repairs, continuations, bundles."""
