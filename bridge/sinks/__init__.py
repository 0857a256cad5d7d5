"""The sinks: one file per outlet, each of which implements `bridge.sink.Sink`."""
