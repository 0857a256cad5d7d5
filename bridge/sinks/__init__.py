"""The sinks: one file per outlet, each implementing `bridge.sink.Sink`."""
