"""Accuracy against cost: measuring and searching the settings of a scene."""
