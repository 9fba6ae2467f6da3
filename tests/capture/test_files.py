"""Names of files in a capture."""

from splatreel.capture.files import natural_key


def test_names_are_sorted_by_their_decimal_digits_only() -> None:
    """Superscripts are digits to Python, but no numbers."""
    names = ["10", "9", "²", "³", "a10", "a9", "٣"]
    assert sorted(names, key=natural_key) == ["9", "10", "a9", "a10", "²", "³", "٣"]
