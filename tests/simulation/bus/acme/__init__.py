"""Extensions of thorvaldc for the robots of Acme."""
