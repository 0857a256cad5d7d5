"""The sinks: each file implements `bridge.sink.Sink` for one kind of output."""
