"""Live runs: a visitor grabs and throws the object in the viewer, over a WebSocket.

    browser (static/touch.js) <-> relay (this server) <-> process (phy124.live), one for each run

The process makes the Gaussians, chooses a grid that runs in real time on this machine, and steps.
It sends the nodes of the lattice that carry the Gaussians; the browser binds the Gaussians to them.
"""

from .relay import socket_route
from .table import Table, Ticket, limits_of

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
