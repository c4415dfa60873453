"""What the tests of joining share."""

from a_centre import centre, owned_template  # noqa: F401 (fixtures)
