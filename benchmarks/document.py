"""Replace what stands between two markers of a document."""


def replaced_between(begin: str, end: str, text: str, inner: str) -> str:
    """Return a document with the text between its two markers replaced.

    Raises:
        ValueError: A marker is missing.
    """
    head, found, rest = text.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"The document has no place for results: put {begin} and {end} on lines of their own.")
    return f"{head}{begin}\n{inner}\n{end}{tail}"
