"""Kinds of arguments that jobs share, as the command line reads them in their signatures."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
"""Seed of random numbers."""
Names = Sequence[str]
"""Names without commas: one option has them all, with commas between. A `Sequence[str]` is an
option that may be given again."""
