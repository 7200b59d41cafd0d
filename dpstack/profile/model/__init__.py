"""What a drive plugin declares: words, states, parameters, telegrams."""
