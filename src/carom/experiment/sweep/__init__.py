"""Many runs of one scene: what varies, who computes them, and what became of each."""
