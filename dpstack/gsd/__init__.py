"""GSD files: lexer, parser, model, user parameters, configurations, diagnosis texts. Octets in, a model out."""
