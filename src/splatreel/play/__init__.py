"""Playback of reels: the web player and its server, the Python viewer, and export."""
