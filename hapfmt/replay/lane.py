"""Values of one actuator -> what it is sent: rectified, clamped, ramped, scaled, limited."""

from __future__ import annotations

from math import floor, isfinite

from .envelope import Envelope, ramp_samples
from .limiter import Limiter, count_limits
from .profile.model import Actuator, Profile

LaneState = tuple[int, int, int, bool, float]


class Lane:
    """Exactly one of ``play`` and ``fall`` is called for each sample that is sent."""

    __slots__ = (
        "_gain",
        "_heard",
        "_held",
        "_maximum",
        "_minimum",
        "_rectify",
        "_rest",
        "_silent",
        "_step",
        "clamped",
        "envelope",
        "gaps",
        "limiter",
        "refused",
        "rest",
    )

    def __init__(self, profile: Profile, actuator: Actuator, gain: float) -> None:
        limits = count_limits(profile, actuator)
        self.limiter = Limiter(limits)
        self.envelope = Envelope(ramp_samples(profile.timing.ramp_s, profile.timing.rate))
        self.rest = limits.rest
        self._rest, self._step, self._rectify = actuator.rest, actuator.step, actuator.rectify
        self._minimum, self._maximum = actuator.minimum, actuator.maximum
        self._gain = gain
        self._held = 0
        """Counts from rest where the fall began."""
        self._heard = False
        self._silent = 0
        self.clamped = self.refused = 0
        self.gaps = 0
        """Samples that were not known between such that were."""

    @property
    def at_rest(self) -> bool:
        return self.envelope.phase == 0 and self.limiter.count == self.rest

    @property
    def samples_to_rest(self) -> int:
        """More than this no fall takes from here."""
        away = abs(self.limiter.count - self.rest)
        return self.envelope.phase - (-away // self.limiter.change)

    def play(self, value: float, known: bool) -> int:
        if not known:
            self._silent += 1
            return self.fall()
        if not isfinite(value):
            self.refused += 1
            return self.fall()
        envelope = self.envelope
        if envelope.falling:
            return self.fall()
        if envelope.phase == 0:
            self.gaps += self._silent if self._heard else 0
            self._heard = True
            self._silent = 0
        if self._rectify:
            value = abs(value)
        if value > self._maximum:
            value = self._maximum
            self.clamped += 1
        elif value < self._minimum:
            value = self._minimum
            self.clamped += 1
        wanted = self._rest + self._gain * envelope.rise() * (value - self._rest)
        return self.limiter(floor(wanted / self._step + 0.5))

    def fall(self) -> int:
        """One sample nearer to rest.

        From what was sent last, not from what was wanted: where the slew limit kept the actuator
        behind a large value, it turns round at once and never comes closer to that value.
        """
        envelope, limiter = self.envelope, self.limiter
        if not envelope.falling:
            if envelope.phase == 0:
                return limiter(self.rest)
            self.cut()
        count = limiter(self.rest + floor(self._held * envelope.fall() + 0.5))
        if envelope.phase == 0 and count == self.rest:
            envelope.falling = False
        return count

    def cut(self) -> None:
        """Fall with the next sample, and all the way to rest."""
        envelope = self.envelope
        if envelope.phase and not envelope.falling:
            envelope.begin_fall()
            self._held = self.limiter.count - self.rest

    def state(self) -> LaneState:
        envelope = self.envelope
        return self.limiter.count, self._held, envelope.phase, envelope.falling, envelope.top

    def restore(self, state: LaneState) -> None:
        """As it was: what came since was not sent. What was counted stays counted."""
        envelope = self.envelope
        self.limiter.count, self._held, envelope.phase, envelope.falling, envelope.top = state

    def forget(self) -> None:
        """What comes next is from elsewhere in the recording: no gap lies before it."""
        self._heard = False
        self._silent = 0
