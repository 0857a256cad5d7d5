"""Live runs: a visitor grabs and throws the object in the viewer, over a WebSocket.

    browser (static/touch.js) <-> relay (this server) <-> process (phy124.live), one per run
The process makes the Gaussians, chooses a grid that runs in real time on this machine, and
simulates. The process sends the nodes of the lattice to which the browser binds the Gaussians.
"""

from .relay import socket_route
from .table import Table, Ticket, limits_of

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
