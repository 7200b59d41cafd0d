"""FDL: telegrams, codec, token ring, active and passive stations."""
