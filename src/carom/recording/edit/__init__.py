"""Files made from recordings: clips, repairs, continuations, bundles."""
