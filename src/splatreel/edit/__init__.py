"""Editing of finished reels without training: operations on clips, and their writer."""
