"""Accuracy against cost: settings of a scene, measured and searched."""
