"""Live runs: a visitor grabs and throws the object in the viewer, over a WebSocket.

Each live run has a process (phy124.live). A relay in this server connects the process with the
browser (static/touch.js). The process makes the Gaussians, chooses a grid that runs in real time on
this machine, and simulates. The process sends the browser the nodes of the lattice to which the
Gaussians are bound.
"""

from .relay import socket_route
from .table import Table, Ticket, limits_of

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
