"""The ledger's study: each rule of the plan omitted or undone in a small scene, and measured."""
