"""`plugd init`: the first configuration by questions. Whatever is accepted is what `plugd.config` accepts."""
