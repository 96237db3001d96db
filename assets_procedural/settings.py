"""Base classes of all plain data: `Settings` of a job, `Parameters` of what a job draws, and
bounded intervals."""

from __future__ import annotations

from pydantic import AfterValidator, BaseModel, ConfigDict


class Settings(BaseModel):
    """Immutable; unknown keys are errors, since a misspelt setting must not pass silently."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Parameters(BaseModel):
    """Immutable plain data that goes to JSON and back without loss."""

    model_config = ConfigDict(frozen=True, extra="forbid")


Interval = tuple[float, float]


def interval(lowest: float, highest: float, unit: str = "") -> AfterValidator:
    """Validator of a (low, high) tuple: ordered, and inside [`lowest`, `highest`] `unit`.

    Use as `Annotated[Interval, interval(-90, 90, "degrees")]`. Equal ends fix a value.
    """
    suffix = f" {unit}" if unit else ""

    def check(value: Interval) -> Interval:
        low, high = value
        if not low <= high:
            raise ValueError(f"[{low:g}, {high:g}] must be [low, high] with low <= high")
        if low < lowest or high > highest:
            raise ValueError(
                f"[{low:g}, {high:g}] must lie within [{lowest:g}, {highest:g}]{suffix}"
            )
        return value

    return AfterValidator(check)
