"""Contacts: their detection, order and resolution."""
