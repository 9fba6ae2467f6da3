"""The web player: its source, its bundle, and how it plays in a real browser."""
