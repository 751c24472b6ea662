"""Lens, pairs and rig from corners; nothing here knows pictures or colour."""
