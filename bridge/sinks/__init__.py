"""The sinks: one file for each kind of output, which implements `bridge.sink.Sink`."""
