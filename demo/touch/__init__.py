"""Live runs: a visitor grabs and throws the object in the viewer, over a WebSocket.

A relay in this server connects the browser (static/touch.js) with a process (phy124.live), one per
run. The process makes the Gaussians, chooses a grid that runs in real time on this machine, and
simulates. The process sends the browser the nodes of the lattice to which the Gaussians are bound.
"""

from .relay import socket_route
from .table import Table, Ticket, limits_of

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
