"""Files made from recordings: clips, repairs, bundles."""
