# What people give on the command line: names that become paths are checked, and everything else is quoted for the shell.
# $(value NAME) is the text as it was given: nothing in it is expanded by make. The Makefile's first lines see to it that
# $(NAME) is the same where that text has a $.

# $(call given,NAME) is a variable's text as one quoted word of a shell command.
given = '$(subst ','\'',$(value $(1)))'

# $(call chosen,FILE,TEXT) names what makes FILE anew where it does not hold TEXT, and nothing where it does. What was made
# of another choice is then made again, however old the files are that it is made from.
chosen = $(if $(subst <$(strip $(2))>,,<$(strip $(file <$(1)))>),choose-anew)
.PHONY: choose-anew
# $(eval $(call choice,FILE,TEXT)) is the rule of such a file.
define choice
$(1): $(call chosen,$(1),$(2))
	@mkdir -p $$(@D) && echo '$(2)' > $$@
endef

LETTERS := a b c d e f g h i j k l m n o p q r s t u v w x y z A B C D E F G H I J K L M N O P Q R S T U V W X Y Z
DIGITS := 0 1 2 3 4 5 6 7 8 9

# $(call without,TEXT,WORDS) is the text without any of these words' characters.
without = $(if $(2),$(call without,$(subst $(firstword $(2)),,$(1)),$(wordlist 2,$(words $(2)),$(2))),$(1))

# Whether a variable's text is one name of letters, digits, _ - and . that starts with none of the last two.
named = $(if $(or $(call without,$(value $(1)),$(LETTERS) $(DIGITS) _ - .),$(filter .% -%,$(value $(1))),$(filter-out 1,$(words $(value $(1))))),,yes)
# Defaults that make works out are no text of others.
by_hand = $(and $(filter command environment override,$(firstword $(origin $(1)))),$(value $(1)))
$(foreach v,DATASET SENSOR MODEL FORMAT EXECUTOR,$(if $(call by_hand,$v),$(if $(call named,$v),,$(error $v=$(value $v): give one name of letters, digits, _ - and . that starts with another character than .))))

# Given but empty, as by DATASET=$UNSET in a script, DATASET would name the folder of all results, and JOBS no limit.
$(foreach v,DATASET MODEL JOBS,$(if $(filter-out undefined default file,$(origin $v)),$(if $(strip $(value $v)),,$(error $v is empty: give a value, or leave it out))))

# Lists of names, and of tests.
$(foreach v,CHARTED TESTS,$(if $(call by_hand,$v),$(if $(strip $(call without,$(value $v),$(LETTERS) $(DIGITS) _ - . / : [ ] ,)),$(error $v=$(value $v): give names with blanks between them))))
ifneq ($(call without,$(call by_hand,JOBS),$(DIGITS)),)
$(error JOBS=$(value JOBS): give a number of jobs)
endif

# RES: words such as 24x32, two numbers from 1 on.
SIDES = $(subst x, ,$(1))
ifneq ($(strip $(call without,$(value RES),$(DIGITS) x) $(filter x% %x,$(value RES)) $(findstring xx,$(value RES)) $(if $(strip $(value RES)),,none) $(foreach w,$(value RES),$(filter-out 2,$(words $(call SIDES,$w))) $(foreach n,$(call SIDES,$w),$(if $(call without,$n,0),,$n)))),)
$(error RES=$(value RES): give resolutions as ROWSxCOLUMNS, such as RES="12x16 24x32")
endif
