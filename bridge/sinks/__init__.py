"""Where frames go: one file per outlet, each fulfils `bridge.sink.Sink`."""
