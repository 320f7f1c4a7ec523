"""A speed loop closed over topics: a PI controller for a gearbox under ``operation.control: torque``.

    python examples/speed_controller.py --ros-args -p speed:=1000.0

It hears ``joint_states`` and sends ``~/command/drive_torque`` of the gearbox. All times are those of the
stamps, so that the loop is the same at any pace of the simulation.
"""

import rclpy
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from gear_dynamics_ros.ros.discovery import stay_local

SILENCE = 1.0  # s of wall time without joint_states after which the loop is open
LONGEST_STEP = 0.05  # s of simulated time that the integral takes for one message


class SpeedController(Node):
    def __init__(self) -> None:
        super().__init__("speed_controller")
        gearbox = self.declare_parameter("gearbox", "/gearbox").value
        self.joint = self.declare_parameter("joint", "driving").value
        # These may be set while it runs.
        self.declare_parameter("speed", 1000.0)  # rad/s
        self.declare_parameter("proportional", 0.11)  # N m s/rad
        self.declare_parameter("integral", 0.55)  # N m/rad
        self.declare_parameter("torque_limit", 200.0)  # N m

        self.integral: float | None = None  # N m; none while the loop is open
        self.last: Time | None = None
        self.heard = False
        self.torque = self.create_publisher(Float64, f"{gearbox}/command/drive_torque", 10)
        # Depth 1: a state that waited behind others is too old to act on.
        self.create_subscription(JointState, "joint_states", self.control, 1)
        self.create_timer(SILENCE, self.watch, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def control(self, state: JointState) -> None:
        if self.joint not in state.name:
            return
        index = state.name.index(self.joint)
        now = Time.from_msg(state.header.stamp)
        if self.integral is None or self.last is None or now < self.last:
            # The torque in force is where the loop takes over without a jump.
            self.integral, self.last = state.effort[index], now
        self.heard = True
        step = min((now - self.last).nanoseconds * 1e-9, LONGEST_STEP)
        self.last = now

        error = self.value("speed") - state.velocity[index]
        limit = self.value("torque_limit")
        wanted = self.value("proportional") * error + self.integral
        torque = min(max(wanted, -limit), limit)
        if torque == wanted or (wanted > limit) == (error < 0.0):
            # At the limit the integral only moves back from it.
            self.integral += self.value("integral") * error * step
        self.torque.publish(Float64(data=torque))

    def watch(self) -> None:
        if not self.heard and self.integral is not None:
            self.get_logger().warning(f"no joint_states for {SILENCE:g} s: the loop is open until they come")
            self.integral = None
        self.heard = False

    def value(self, name: str) -> float:
        return float(self.get_parameter(name).value)


def main() -> None:
    stay_local()
    rclpy.init()
    try:
        rclpy.spin(SpeedController())
    except (KeyboardInterrupt, ExternalShutdownException):
        # Silence ends the command: operation.command_timeout of the gearbox decides what follows.
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
