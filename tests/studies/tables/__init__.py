"""Whether a diagnosis of any table ends with an answer or a refusal, and in no other way."""
