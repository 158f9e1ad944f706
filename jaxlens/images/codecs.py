"""imagecodecs, an extra: 80 MB of codecs that most pictures do without."""

from types import ModuleType

from jaxlens.images.picture import ImageError


def codecs(purpose: str) -> ModuleType:
    """Returns imagecodecs.

    Args:
        purpose: What it is needed for, in the words of the message.

    Raises:
        ImageError: it is not installed.
    """
    try:
        import imagecodecs
    except ImportError as error:
        raise ImageError(f"{purpose} takes imagecodecs: pip install 'jaxlens[codecs]'") from error
    return imagecodecs
