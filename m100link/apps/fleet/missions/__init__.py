"""Missions of a fleet: a plan goes up in one piece, is named by its digest, and flies on board."""
