"""Studies that run many simulations through the public interface: fits, sweeps and validation."""
