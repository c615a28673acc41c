"""Concealed recordings: draws what is hidden, seals the answers, scores the verdicts. Never imported by the tool."""
