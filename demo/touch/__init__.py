"""Live runs: a visitor grabs and throws the object in the viewer, over a WebSocket.

Each live run has a process (phy124.live), which a relay in this server connects with the browser
(static/touch.js). The process chooses a grid that runs in real time on this machine, and sends the
nodes of the lattice to the browser; the Gaussians are bound to these nodes.
"""

from .relay import socket_route
from .table import Table, Ticket, limits_of

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
