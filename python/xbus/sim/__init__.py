"""Virtual devices: their motion, measurements and replies, and servers that other programs connect to."""

from xbus.sim.bus_faults import BusFaults
from xbus.sim.buses import I2cMessage, SimI2c, SimSpi
from xbus.sim.device import SimulatedDevice
from xbus.sim.faults import Faults
from xbus.sim.motion import Motion, SampledTrajectory, Trajectory
from xbus.sim.replay import Replay
from xbus.sim.serve import PtyServer, Server, TcpServer, serve, serving
from xbus.sim.trajectories import TRAJECTORIES

__all__ = [
    "TRAJECTORIES",
    "BusFaults",
    "Faults",
    "I2cMessage",
    "Motion",
    "PtyServer",
    "Replay",
    "SampledTrajectory",
    "Server",
    "SimI2c",
    "SimSpi",
    "SimulatedDevice",
    "TcpServer",
    "Trajectory",
    "serve",
    "serving",
]
