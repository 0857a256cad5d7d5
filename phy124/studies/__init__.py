"""Work on top of the public interface: fits, sweeps and validation."""
