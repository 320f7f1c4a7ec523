"""The file of the report of a run of the test harness."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.harness.outcome import ProfileOutcome
from gear_dynamics_ros.harness.profile import Profile
from gear_dynamics_ros.harness.results import unreached
from gear_dynamics_ros.reporting.drive_page import DriveRun, drive_page
from gear_dynamics_ros.system.files import output_file


class DriveReport:
    """The report of one profile, there from the start of the run on."""

    def __init__(
        self, path: Path, profile: Profile, source: Path, node: str, pace: str, environment: Mapping[str, str]
    ) -> None:
        """``source`` is the file of the profile, ``pace`` says in words how commands are timed."""
        self._path = path
        self._run = DriveRun(profile, str(source), node, pace, environment, _now(), "")

    def write_unfinished(self) -> None:
        """Write the report of a run that did not end, which stays if this process is killed.

        Raises UsageError if the file can't be written.
        """
        expectations = self._run.profile.expectations
        outcome = ProfileOutcome(unreached(expectations), 0, [], 0.0, "", "drive did not end by itself", 0)
        try:
            self._write(self._run, outcome)
        except GearboxError as error:
            raise UsageError(f"--report: {error}") from error

    def write(self, outcome: ProfileOutcome) -> None:
        """Write the report of the run, also if it failed or broke off.

        Raises GearboxError if the file can't be written; the earlier report stays then.
        """
        self._write(self._run._replace(ended=_now()), outcome)

    def _write(self, run: DriveRun, outcome: ProfileOutcome) -> None:
        with output_file(self._path) as stream:
            stream.write(drive_page(run, outcome))


def _now() -> str:
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC"
