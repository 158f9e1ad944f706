"""HTML that is escaped by construction: text is text, and only `element` makes markup."""

from html import escape
from urllib.parse import quote

_EMPTY = frozenset({"br", "img", "link", "meta"})


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def element(tag: str, *children: str | None, **attributes: str | int | bool | None) -> Markup:
    """Returns an element.

    Args:
        tag: Its name.
        children: What is in it: `Markup` as it is, other text escaped, None left out.
        attributes: By name; a trailing underscore is dropped, as in `class_`, and others become dashes. True gives a
            bare name, False and None leave it out.

    Example:
        >>> element("p", "1 < 2, ", element("b", "surely"), class_="note")
        '<p class="note">1 &lt; 2, <b>surely</b></p>'
    """
    words = [tag]
    for name, value in attributes.items():
        name = name.rstrip("_").replace("_", "-")
        if value is True:
            words.append(name)
        elif value is not None and value is not False:
            words.append(f'{name}="{escape(str(value))}"')
    opening = f"<{' '.join(words)}>"
    if tag in _EMPTY:
        return Markup(opening)
    return Markup(f"{opening}{join(*children)}</{tag}>")


def join(*children: str | None) -> Markup:
    """Returns markup and text after one another."""
    return Markup(
        "".join(child if isinstance(child, Markup) else escape(child, quote=False) for child in children if child)
    )


def link(text: str, *parts: str) -> Markup:
    """Returns a link to a file, relative to the page, given by the parts of its path."""
    return element("a", text, href="/".join(quote(part) for part in parts))
