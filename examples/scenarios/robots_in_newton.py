"""Four robots in Newton, each in a world of its own with its base driver.

Needs `thorvaldc build examples/4wd4ws_wide/robot.yaml --target mjcf -o build/wide`, and prints the
true position and the pose of the odometry of each.
"""

import newton

import thorvaldc
from thorvaldc.runtime.base_interface import BaseHandle, JointStates

WORLDS, STEP, DURATION = 4, 0.005, 2.0  # s
robot = thorvaldc.load("examples/4wd4ws_wide/robot.yaml")
one, worlds = newton.ModelBuilder(), newton.ModelBuilder()
for builder in (one, worlds):
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
one.add_mjcf("build/wide/mjcf/scene.xml", parse_visuals=False)
worlds.replicate(one, WORLDS)
model = worlds.finalize()
solver = newton.solvers.SolverMuJoCo(model)
state, after, control = model.state(), model.state(), model.control()

names = [label.rpartition("/")[2] for label in one.joint_label]
q_of = dict(zip(names, one.joint_q_start, strict=False))  # indices in the arrays of one world
qd_of = dict(zip(names, one.joint_qd_start, strict=False))
ctrl_of = {motor.joint: i for i, motor in enumerate(robot.actuators)}  # the order of the MJCF
q, qd, angles, ctrl = (
    array.numpy().reshape(WORLDS, -1).copy()
    for array in (state.joint_q, state.joint_qd, control.joint_target_q, control.mujoco.ctrl)
)


class NewtonBase(BaseHandle):
    """The joints of the robot of one world."""

    def __init__(self, world):
        self.world = world

    def read(self, now):
        q_here, qd_here = q[self.world].tolist(), qd[self.world].tolist()
        spin = [wheel.spin_joint for wheel in robot.wheels]
        steering = [wheel.steering_joint for wheel in robot.wheels]
        return JointStates(
            now,
            [qd_here[qd_of[name]] for name in spin],
            [q_here[q_of[name]] for name in steering],
            [qd_here[qd_of[name]] for name in steering],
            [q_here[q_of[name]] for name in spin],
        )

    def write(self, commands, now):
        for wheel, speed, angle in zip(robot.wheels, commands.speeds, commands.angles, strict=True):
            ctrl[self.world, ctrl_of[wheel.spin_joint]] = speed
            angles[self.world, q_of[wheel.steering_joint]] = angle


drivers = [thorvaldc.BaseDriver(robot, NewtonBase(world)) for world in range(WORLDS)]
period = 1.0 / robot.driver.rate
for tick in range(round(DURATION / period)):
    for world, driver in enumerate(drivers):
        driver.command(thorvaldc.Twist(0.5, 0.0, 0.1 * world), now=tick * period)
        driver.tick(tick * period)
    control.mujoco.ctrl.assign(ctrl.ravel())
    control.joint_target_q.assign(angles.ravel())
    for _ in range(round(period / STEP)):
        solver.step(state, after, control, None, STEP)
        state, after = after, state
    q[:] = state.joint_q.numpy().reshape(q.shape)
    qd[:] = state.joint_qd.numpy().reshape(qd.shape)
for world, driver in enumerate(drivers):
    print(q[world, :2], driver.state.pose)  # the true position, the pose of the odometry
