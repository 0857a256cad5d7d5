"""Touch: a live run that a visitor holds and throws in the viewer, over one WebSocket.

    browser (static/touch.js) <-> relay (this server) <-> process (phy124.live), one for each run

The process makes the Gaussians, chooses a grid that this machine holds in real time, and steps. It
sends the nodes of the lattice that carry the Gaussians; the browser binds the Gaussians to them.
"""

from .relay import socket_route
from .sessions import limits_of
from .table import Table, Ticket

__all__ = ["Table", "Ticket", "limits_of", "socket_route"]
