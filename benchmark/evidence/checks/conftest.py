"""The fixtures of the tests, for the checks of the scripts."""

from tests.conftest import *  # noqa: F403
