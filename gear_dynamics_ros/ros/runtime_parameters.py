"""Parameters of the node at run time: each change is validated once and passed to the run."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.parameters import ParameterChange, Parameters
from gear_dynamics_ros.ros import node_parameters
from gear_dynamics_ros.ros.deferred_answers import AnswerSender, defer_parameter_answers, on_executor

SIM_TIME = "use_sim_time must stay false: the gearbox makes time and never follows /clock"
RESTORING = "a checkpoint is being restored: set parameters again when ~/restore_checkpoint has answered"


class RuntimeParameters:
    """The parameters of ``node`` and their changes. For the thread that spins the node."""

    def __init__(
        self,
        node: Node,
        sender: AnswerSender,
        apply: Callable[[ParameterChange], Future[None] | None],
        in_force: Callable[[], Parameters],
    ) -> None:
        """Declare the parameters of ``node``. Raises UsageError if one of them is invalid.

        ``apply`` puts a change in force; if that takes time, it returns a future. ``in_force`` returns the
        parameters in force in the run.
        """
        self._node = node
        self._apply = apply
        self._in_force = in_force
        self.current = node_parameters.declare(node)
        self._change: ParameterChange | None = None  # validated, about to be set
        self._work: Future[None] | None = None  # begun by the present request
        self._restores = 0  # in progress
        self._showing = False  # whether the values being set are in force already
        self._ignore_sim_time()
        node.add_pre_set_parameters_callback(self._prepare)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._set)
        defer_parameter_answers(node, sender, self._take_work)

    def restore(self, start: Callable[[], Future[str]]) -> Future[str]:
        """Result of the restore that ``start`` begins; afterwards the node shows the restored parameters.

        Other changes are refused meanwhile: they would be validated against parameters about to be replaced.
        """
        self._restores += 1

        def done() -> None:
            self._restores -= 1
            self._show(self._in_force())

        try:
            work = start()
        except Exception:
            self._restores -= 1
            raise
        return on_executor(self._node, work, done)

    def _ignore_sim_time(self) -> None:
        if self._node.get_parameter("use_sim_time").value:
            self._node.get_logger().info(
                "use_sim_time is ignored: the gearbox makes time and never follows /clock"
            )
            self._node.set_parameters([Parameter("use_sim_time", Parameter.Type.BOOL, False)])

    def _prepare(self, parameters: list[Parameter]) -> list[Parameter]:
        node_parameters.require_known(self._node, parameters)
        return node_parameters.numbers_to_floats(parameters)

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        if any(parameter.name == "use_sim_time" and parameter.value for parameter in parameters):
            return SetParametersResult(successful=False, reason=SIM_TIME)
        if self._restores and not self._showing:
            return SetParametersResult(successful=False, reason=RESTORING)
        try:
            self._change = node_parameters.change_by(self.current, parameters)
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _set(self, _: list[Parameter]) -> None:
        change, self._change = self._change, None
        if change is None or not change.values:
            return
        self.current = change.new
        work = self._apply(change)
        if work is not None:
            self._work = on_executor(self._node, work, lambda: self._undo_failed(work))

    def _undo_failed(self, work: Future[None]) -> None:
        if work.exception() is not None:
            self._show(self._in_force())

    def _show(self, parameters: Parameters) -> None:
        """Set the parameters of the node to ``parameters``, which are in force already."""
        values = node_parameters.to_set(self.current, parameters)
        self.current = parameters
        if values:
            self._showing = True
            try:
                result = self._node.set_parameters_atomically(values)
            finally:
                self._showing = False
            if not result.successful:
                raise GearboxError(f"the node's parameters do not show those in force: {result.reason}")

    def _take_work(self) -> Future[None] | None:
        work, self._work = self._work, None
        return work
