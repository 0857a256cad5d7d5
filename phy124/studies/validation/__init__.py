"""Whether the solver is right: experiments, hard cases and known solutions."""
