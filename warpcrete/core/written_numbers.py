"""Numbers that remember the text from which they were converted, so that messages can quote the text."""


class WrittenNumber(float):
    """Number in SI units that was converted from a text with a unit, such as "30 m3/h".

    Messages quote the attribute `text`, which the user wrote. The result of any computation is a plain number.
    """

    text: str

    def __new__(cls, value: float, text: str = "") -> "WrittenNumber":
        number = super().__new__(cls, value)
        number.text = text
        return number


def written_text(value: object) -> str:
    """Return the text from which a number was converted; empty if `value` is no :class:`WrittenNumber`."""
    return value.text if isinstance(value, WrittenNumber) else ""
